"""Interoperation with other programs: HUGSIM, OpenSCENARIO, OpenDRIVE, ROS 2, Rerun."""
