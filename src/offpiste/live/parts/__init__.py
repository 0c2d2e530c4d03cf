"""The processes of a drive: each takes what is newest, and waits for none of the others."""
