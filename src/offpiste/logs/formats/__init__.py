"""Log formats that ship: one module each; a module dropped here is found (`offpiste.logs.log.LOG_FORMATS`)."""
