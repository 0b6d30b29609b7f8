"""Evaluation of folders of scenes, reports, the paper's experiments."""
