"""Records of closed loops and of solve(): logs, recordings, replays of dumps, their tables and files."""
