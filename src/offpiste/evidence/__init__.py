"""What seeing the ground is worth on a user's own drives, with controls, in one report."""
