"""What is pressed, how and on which rig: the values and the file that they are read from."""
