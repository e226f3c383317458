"""Scene data, cameras and the files they are read from; depends on no other package of the engine."""
