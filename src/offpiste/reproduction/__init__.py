"""The paper's figures 3 and 4, from simulated or recorded drives, in one command that resumes where it stopped."""
