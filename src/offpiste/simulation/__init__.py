"""The proving ground: a world, a vehicle whose physics is not the model's, and sensors that record real logs."""
