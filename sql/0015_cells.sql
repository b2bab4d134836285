-- Cells: the machines of a site, each with its own nginx, web, relay and sshd (docs/adr/0036-cells-and-one-host-key.md).

-- The relay of each cell writes its row every second; `draining` alone is written by web's account. host, the port of
-- its pages and ssh_ports (numbers with commas between, the best first): where robots and people reach it; no host:
-- robots are not sent there. peer_address: where other cells reach it. robots: how many are online there.
CREATE TABLE IF NOT EXISTS cells (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  name VARCHAR(63) NOT NULL UNIQUE,
  host VARCHAR(253) NULL,
  https_port SMALLINT UNSIGNED NOT NULL,
  ssh_ports VARCHAR(255) NOT NULL,
  peer_address VARCHAR(260) NULL,
  version VARCHAR(32) NOT NULL,
  robots INT UNSIGNED NOT NULL DEFAULT 0,
  draining BOOLEAN NOT NULL DEFAULT FALSE,
  started_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  heartbeat_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6)
);

-- Whose relay wrote the row; NULL in rows from before cells, and in those of an older relay. epoch: the agent's number
-- of the session, by which two of one robot are told apart; 0: it gave none.
ALTER TABLE robot_sessions
  ADD COLUMN IF NOT EXISTS cell VARCHAR(63) NULL,
  ADD COLUMN IF NOT EXISTS epoch BIGINT UNSIGNED NOT NULL DEFAULT 0;
ALTER TABLE drives ADD COLUMN IF NOT EXISTS cell VARCHAR(63) NULL;
ALTER TABLE control_leases ADD COLUMN IF NOT EXISTS cell VARCHAR(63) NULL;

-- Removes a cell that will not come back, and ends what its relay left open when it was last alive: nobody else would.
CREATE OR REPLACE PROCEDURE remove_cell(IN cell_name VARCHAR(63)) SQL SECURITY DEFINER
BEGIN
  DECLARE last_alive TIMESTAMP(6) DEFAULT (SELECT heartbeat_at FROM cells WHERE name = cell_name);
  UPDATE robot_sessions SET ended_at = last_alive, end_code = 'cell_removed' WHERE cell = cell_name AND ended_at IS NULL;
  UPDATE drives SET ended_at = updated_at, end_code = 'cell_removed' WHERE cell = cell_name AND ended_at IS NULL;
  UPDATE control_leases SET ended_at = last_alive WHERE cell = cell_name AND ended_at IS NULL;
  DELETE FROM cells WHERE name = cell_name;
END;

GRANT SELECT,
  INSERT (name, host, https_port, ssh_ports, peer_address, version, robots, started_at, heartbeat_at),
  UPDATE (host, https_port, ssh_ports, peer_address, version, robots, started_at, heartbeat_at)
  ON cells TO 'relay'@'%';
GRANT SELECT, UPDATE (draining) ON cells TO 'web'@'%';
GRANT EXECUTE ON PROCEDURE remove_cell TO 'web'@'%';
