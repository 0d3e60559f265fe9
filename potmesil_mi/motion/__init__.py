"""What moves in a scene, and when: tracks of numbers, moves of camera and shapes, the shutter."""
