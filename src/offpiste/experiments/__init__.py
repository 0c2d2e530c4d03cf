"""What needs every stage: the demo."""
