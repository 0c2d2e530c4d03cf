"""Whole drives of `offpiste live`: courses beside the same in lockstep, and half an hour of memory and deadlines."""
