"""How good a picture is and how long it takes, beside a ray-traced lens."""
