"""What every cell needs: messages, bus, configuration, launching, recording, replay, view, safety, belief."""
