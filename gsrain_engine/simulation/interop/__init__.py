"""Interoperation with other programs: HUGSIM, OpenSCENARIO, OpenDRIVE, MCAP."""
