"""Evaluation of models on unseen windows: errors, intervals, figures, report."""
