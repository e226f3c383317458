"""Other programs: HUGSIM, OpenSCENARIO, OpenDRIVE, MCAP."""
