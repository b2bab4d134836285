-- Whether everybody in the robot's own network reaches its rosbridge, past the guard, as the agent told last.
-- Written by the relay alone.
ALTER TABLE robot_sessions ADD COLUMN IF NOT EXISTS ros_exposed BOOLEAN NOT NULL DEFAULT FALSE;
