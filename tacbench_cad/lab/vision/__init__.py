"""What a camera sees of a sensor: where the sensor lies in the frame, and where its markers are."""
