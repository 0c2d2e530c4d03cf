"""`offpiste demo`: shipped models at work on new ground in a minute, or the whole path from driving to driving."""
