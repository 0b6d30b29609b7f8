"""The paper: arrays and values in, values out."""

# from hid2.kernels.compiled_cache import keep_compiled

# keep_compiled()
