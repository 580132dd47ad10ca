"""What Rerun shows of a session."""
