"""Recordings in, recordings out: readers, writers, validation."""
