"""Scenes in checkpoints of trainings: drivestudio, StreetGaussians, nerfstudio, MTGS, gsplat, 3DGS."""
