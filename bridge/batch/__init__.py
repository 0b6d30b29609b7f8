"""Many scenes: tasks, isolated processes, Dask, manifest, quarantine."""
