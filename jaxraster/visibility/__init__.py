"""Which triangle each pixel sees: scene + camera -> Visibility."""
