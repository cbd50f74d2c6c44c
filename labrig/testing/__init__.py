"""testing: the conformance tests that every driver passes, labrig's own and yours.

A suite is a class of tests. Derive a class from it in a test file, with a name that begins with Test and a method that
opens the device, and run pytest. No other room imports them.
"""
