"""The command line: parse, show, hand over; no maths.

Errors of the library go through every function of this package as they are; `console.guarded`
makes one message of them, and the exit code.
"""
