"""Where the virtual hand and the devices of a laboratory meet: rendering what is touched, the haptic loop."""
