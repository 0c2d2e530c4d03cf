"""Evaluation of models on windows they have not seen: errors, intervals, figures, a report."""
