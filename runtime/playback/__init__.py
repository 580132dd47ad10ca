"""What a replay is made of: what is played, its state, the keys that lead it."""
