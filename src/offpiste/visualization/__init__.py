"""Logs and datasets as people look at them: pictures, a Rerun recording, a report of what the features cover."""
