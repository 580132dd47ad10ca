"""A recorded session decided again by today's code."""
