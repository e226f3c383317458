"""Driving in the window: what is wished for, the job, and roll-outs that are played in the scene."""
