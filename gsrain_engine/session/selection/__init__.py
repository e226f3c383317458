"""Which Gaussians are selected: pure functions from a scene to flags a member, and from those to another scene."""
