"""What lies at each pixel: Visibility -> Surface."""
