"""Other rasterizers on the same clip positions, each imported only when asked for."""
