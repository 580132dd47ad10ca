"""What was found in searches, kept for good and shared between cells."""
