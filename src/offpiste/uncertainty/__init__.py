"""How far predictions stray: spreads that grow along a rollout, and whether they are calibrated."""
