"""The simulated side-by-side: bodies, tyres, drive train and chassis."""
