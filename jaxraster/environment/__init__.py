"""Surroundings: pictures of all directions, skies, and what matter of each roughness sees of them."""
