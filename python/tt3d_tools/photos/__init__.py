"""From photographs or a video to a capture: frames, cameras, upright world, masks, page."""
