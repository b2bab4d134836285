-- The relay shows a robot's MAC to whoever sees the robot: another one may get its name. As in 0019.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_robots AS
  SELECT r.id, r.name, r.mac, r.state, r.ros_port, r.video_port, r.settings, r.agent_version, r.updated_at,
    r.shell_port, r.fingerprint, r.previous_fingerprint, r.rotate_requested_at IS NOT NULL AS rotate_key,
    s.name AS site, o.state AS other_key
  FROM robots r LEFT JOIN sites s ON s.id = r.site_id LEFT JOIN other_keys o ON o.robot_id = r.id;
