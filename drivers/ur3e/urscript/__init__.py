"""URScript: text to a program that runs one control cycle at a time. Knows the language, not the robot."""
