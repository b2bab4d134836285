-- Robots from before this limit keep their speed, however late their driver sees: null is no limit. Others have the
-- default.
UPDATE robots
  SET settings = JSON_MERGE_PRESERVE(settings, '{"guard": {"blind_m": null, "blind_deg": null}}')
  WHERE NOT JSON_CONTAINS_PATH(settings, 'one', '$.guard.blind_m', '$.guard.blind_deg');

-- For how long the robot's guard slowed the driver's commands, because they saw late; NULL: it reported nothing.
ALTER TABLE drives ADD COLUMN IF NOT EXISTS slowed_s DOUBLE NULL;
