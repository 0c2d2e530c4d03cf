"""The simulated side-by-side: rigid bodies, tyres, drivetrain and chassis."""
