"""Driving on the proving ground with learned models: what anticipating the ground is worth."""
