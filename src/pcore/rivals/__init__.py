"""Rules and trainings of methods that objects are compared with, reimplemented from their papers.

None of them is the published code. Tables name whose rule it is and whose trainer.
"""
