"""What the picture itself tells of its light: ambient occlusion from the depths that are on the screen."""
