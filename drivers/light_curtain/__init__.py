"""The light curtain."""
