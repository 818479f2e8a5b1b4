"""The region of the sensor in a camera's frame, and the positions of the sensor's markers."""
