"""Recorded sessions as files: written, read, recovered, summed up."""
