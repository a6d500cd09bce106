"""Records of closed loops and of solve(), and what notebooks show: tables, pictures, files."""
