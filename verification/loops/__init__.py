"""Draws of closed loops whose plans one full step per sample does not bring nearer, against solve() in every sample."""
