"""What a scene is made of, and the files it comes from. Uses nothing else of ours."""
