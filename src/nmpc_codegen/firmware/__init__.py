"""Proof that a package runs on a microcontroller: cross builds, a run on an emulated board, a certificate.

    Sources -> recording (host) -> image -> emulate -> verify
    Sources -> objects -> certificate -> budgets

Everything starts from the text of a package; CasADi is not needed here. The programs that are run are
arm-none-eabi-gcc with its binutils, and qemu-system-arm.
"""
