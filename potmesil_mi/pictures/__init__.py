"""Pictures of other programs: their channels, what they say of the camera, and their ids."""
