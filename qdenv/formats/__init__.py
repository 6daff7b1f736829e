"""Readers and writers of layout files."""
