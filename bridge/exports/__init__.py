"""Scenes in the formats of others."""
