"""Labeled data sets in rain, in the layouts of nuScenes, KITTI and COCO: of scenes, recordings and scenarios."""
