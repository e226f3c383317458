"""The loop: observe, plan, steer, move everybody on."""
