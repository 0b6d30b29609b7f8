"""hid2/evaluation."""
