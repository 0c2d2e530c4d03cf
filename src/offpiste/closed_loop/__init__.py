"""Closed-loop driving on the proving ground with trained models, and its scores."""
