"""What every stage uses: conventions, geometry, channels, state, errors, files and registries."""
