-- How far a robot turned that takes a steering angle is not known: NULL. Rows of cars from before say 0.
ALTER TABLE drives
  MODIFY turned_rad DOUBLE NULL DEFAULT 0,
  MODIFY top_turn_rad_s DOUBLE NULL DEFAULT 0;
