"""The crowd: bodies, people, sensors and the environments built on them."""
