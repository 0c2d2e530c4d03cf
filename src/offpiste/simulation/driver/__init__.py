"""The simulated driver: routes, behaviour and manoeuvres."""
