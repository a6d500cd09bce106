"""Packages run on emulated Cortex-M boards: agreement with the host, memory, stack, instructions, single precision."""
