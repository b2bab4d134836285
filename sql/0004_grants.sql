-- What each account may do; images/mysql makes the accounts and gives migrate its rights.

GRANT SELECT, INSERT, UPDATE, DELETE ON users TO 'web'@'%';
GRANT SELECT, INSERT, UPDATE, DELETE ON robots TO 'web'@'%';
GRANT SELECT, INSERT, UPDATE, DELETE ON grants TO 'web'@'%';
GRANT SELECT, INSERT, UPDATE, DELETE ON api_tokens TO 'web'@'%';
GRANT SELECT, INSERT, UPDATE, DELETE ON logins TO 'web'@'%';
GRANT SELECT ON robot_sessions TO 'web'@'%';
GRANT SELECT, INSERT ON audit_events TO 'web'@'%';

GRANT SELECT ON relay_robots TO 'relay'@'%';
GRANT SELECT ON relay_grants TO 'relay'@'%';
GRANT SELECT ON relay_logins TO 'relay'@'%';
GRANT SELECT ON relay_tokens TO 'relay'@'%';
GRANT SELECT ON relay_changes TO 'relay'@'%';
GRANT SELECT, INSERT, UPDATE ON robot_sessions TO 'relay'@'%';
GRANT INSERT ON audit_events TO 'relay'@'%';

GRANT SELECT ON tunnel_keys TO 'keylookup'@'%';
GRANT EXECUTE ON PROCEDURE record_refused_key TO 'keylookup'@'%';
