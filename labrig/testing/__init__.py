"""testing: conformance suites that every driver passes, ours and a lab's own.

A suite is a class of tests. Inherit it in a test file under a name that begins with Test, say how the device is opened,
and run pytest; it needs nothing of pytest itself, and labrig imports nothing of it.
"""
