"""What object detectors find in pictures: ONNX files run, matched with labelled objects, scored."""
