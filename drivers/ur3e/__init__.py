"""The UR3e: one arm interface under the names of UR's RTDE, the insertion skill on top of it, and the simulated arm."""
