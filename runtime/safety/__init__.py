"""The interlock, and the arm's side of it: no fresh permit, no motion."""
