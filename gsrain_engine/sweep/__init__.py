"""Many runs: every combination of scenes, scenarios, intensities, seeds and agents."""
