"""The single agent of the maze: its world, its episodes, its policy."""
