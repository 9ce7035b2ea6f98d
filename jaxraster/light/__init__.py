"""Light on surfaces: Surface + Lights -> Radiance."""
