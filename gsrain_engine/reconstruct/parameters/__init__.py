"""What is trained: the parameters of splats and the step that changes them."""
