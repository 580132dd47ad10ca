"""The simulated arm's control box: modes, safety, programs, and the ports that UR's clients connect to."""
