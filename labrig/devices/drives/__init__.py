"""Drives: one driver of CiA 402, and each product as an EDS file and a model."""
