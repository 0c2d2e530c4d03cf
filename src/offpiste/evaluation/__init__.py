"""Judge models on windows they have not seen: errors, intervals, pictures, a report."""
