"""Controls: experiments that would show it if a gain from terrain features were not what it seems."""
