-- Web apps as ends of routes (docs/howto/routes.md). As in 0001, every statement may run twice.

-- source_app, target_app: the name of a web app of the route's maker, where that end is no robot. One end at least is a robot.
ALTER TABLE routes
  MODIFY COLUMN source_id INT UNSIGNED NULL,
  MODIFY COLUMN target_id INT UNSIGNED NULL,
  ADD COLUMN IF NOT EXISTS source_app VARCHAR(63) NULL,
  ADD COLUMN IF NOT EXISTS target_app VARCHAR(63) NULL;
ALTER TABLE routes DROP CONSTRAINT IF EXISTS routes_ends;
ALTER TABLE routes ADD CONSTRAINT routes_ends CHECK (
  (source_id IS NULL) = (source_app IS NOT NULL) AND (target_id IS NULL) = (target_app IS NOT NULL)
  AND COALESCE(source_id, 0) <> COALESCE(target_id, 0));

-- As in 0026, for relays of versions before, which would end a route with an app.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_routes AS
  SELECT r.id, r.source_id, r.source_topic, r.target_id, r.target_topic, r.type, r.rate_hz, r.user_id,
    u.name AS user_name, r.ends_at
  FROM routes r JOIN users u ON u.id = r.user_id
  WHERE r.ended_at IS NULL AND (r.ends_at IS NULL OR r.ends_at > CURRENT_TIMESTAMP(6))
    AND r.source_id IS NOT NULL AND r.target_id IS NOT NULL;

-- All that last, with their makers' names, for relays.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_lasting_routes AS
  SELECT r.id, r.source_id, r.source_app, r.source_topic, r.target_id, r.target_app, r.target_topic, r.type, r.rate_hz,
    r.user_id, u.name AS user_name, r.ends_at
  FROM routes r JOIN users u ON u.id = r.user_id
  WHERE r.ended_at IS NULL AND (r.ends_at IS NULL OR r.ends_at > CURRENT_TIMESTAMP(6));

GRANT SELECT ON relay_lasting_routes TO 'relay'@'%';
