"""The published results; what is installed of them is ``record``, see the evaluation's record."""
