"""Measures of whole scenes, above `hid2.measures`."""
