"""Scenarios as OpenSCENARIO XML: read, and written with an OpenDRIVE road."""
