"""The paper: arrays and values in, values out."""
