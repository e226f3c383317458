"""Interoperation with other programs: HUGSIM."""
