"""Reproduction of the paper's figures 3 and 4, from simulated or recorded drives, in resumable steps."""
