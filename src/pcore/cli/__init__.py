"""The command line: parse, show, hand over; no maths."""
