"""Firmware checks that a package runs on a microcontroller: cross builds, a run on an emulated board, a certificate.

    Sources -> recording (host) -> image -> emulate -> verify
    Sources -> objects -> certificate -> budgets

Everything starts from the text of a package; CasADi is not needed here. It runs a cross compiler with its binutils,
such as arm-none-eabi-gcc, and an emulator, such as qemu-system-arm.
"""
