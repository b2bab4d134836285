-- How long requests wait that somebody had accepted. As in 0001, every statement may run twice.

-- waits_since: when it began to wait again after somebody had accepted it; NULL: it waits, or waited, since it was made.
ALTER TABLE help_requests ADD COLUMN IF NOT EXISTS waits_since TIMESTAMP(6) NULL DEFAULT NULL;

-- As in 0025, and waited_s: for how long it has waited until now, whatever its state.
CREATE OR REPLACE SQL SECURITY DEFINER VIEW relay_requests AS
  SELECT h.robot_id, h.state, TIMESTAMPDIFF(MICROSECOND, h.created_at, CURRENT_TIMESTAMP(6)) / 1e6 AS age_s,
    TIMESTAMPDIFF(MICROSECOND, COALESCE(h.waits_since, h.created_at), CURRENT_TIMESTAMP(6)) / 1e6 AS waited_s,
    u.id AS user_id, u.name AS user_name,
    TIMESTAMPDIFF(MICROSECOND, CURRENT_TIMESTAMP(6),
      IF(h.state = 'offered', h.offer_until, h.accepted_at + INTERVAL 30 SECOND)) / 1e6 AS left_s
  FROM help_requests h
  LEFT JOIN users u ON u.id = IF(h.state = 'offered', h.offered_to, h.accepted_by) AND NOT u.disabled
  WHERE h.state IN ('waiting', 'offered', 'accepted');
