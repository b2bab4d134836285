-- Groups of users, sites of robots, and grants for either, with or without an end. As in 0001, every statement
-- may run twice: on rows that are so already, each of them changes nothing.

CREATE TABLE IF NOT EXISTS sites (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  name VARCHAR(63) NOT NULL UNIQUE,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  CONSTRAINT sites_name CHECK (name REGEXP '^[a-z0-9][a-z0-9._-]*\\z')
);

-- A robot is at one site or at none.
ALTER TABLE robots
  ADD COLUMN IF NOT EXISTS site_id INT UNSIGNED NULL,
  ADD CONSTRAINT robots_site FOREIGN KEY IF NOT EXISTS robots_site (site_id) REFERENCES sites (id) ON DELETE SET NULL;

CREATE TABLE IF NOT EXISTS user_groups (
  id INT UNSIGNED NOT NULL AUTO_INCREMENT PRIMARY KEY,
  name VARCHAR(63) NOT NULL UNIQUE,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  CONSTRAINT user_groups_name CHECK (name REGEXP '^[a-z0-9][a-z0-9._-]*\\z')
);

CREATE TABLE IF NOT EXISTS user_group_members (
  group_id INT UNSIGNED NOT NULL,
  user_id INT UNSIGNED NOT NULL,
  created_at TIMESTAMP(6) NOT NULL DEFAULT CURRENT_TIMESTAMP(6),
  PRIMARY KEY (group_id, user_id),
  KEY user_group_members_user (user_id),
  CONSTRAINT user_group_members_group FOREIGN KEY (group_id) REFERENCES user_groups (id) ON DELETE CASCADE,
  CONSTRAINT user_group_members_user FOREIGN KEY (user_id) REFERENCES users (id) ON DELETE CASCADE
);

-- From now on a grant is for a user or a group, and for a robot, a site or all robots. That it is for all stands in
-- a column of its own, so that no row can come to mean all robots because something else of it is missing.
-- holder and scope: one number each for who and what (even and odd keep the two kinds apart), for a unique key,
-- which NULLs would get past. The key that is dropped is given anew in the same statement, also at a second run.
ALTER TABLE grants
  ADD COLUMN IF NOT EXISTS id INT UNSIGNED NOT NULL AUTO_INCREMENT FIRST,
  MODIFY COLUMN user_id INT UNSIGNED NULL,
  ADD COLUMN IF NOT EXISTS group_id INT UNSIGNED NULL AFTER user_id,
  MODIFY COLUMN robot_id INT UNSIGNED NULL,
  ADD COLUMN IF NOT EXISTS site_id INT UNSIGNED NULL AFTER robot_id,
  ADD COLUMN IF NOT EXISTS all_robots BOOLEAN NOT NULL DEFAULT FALSE AFTER site_id,
  ADD COLUMN IF NOT EXISTS expires_at TIMESTAMP(6) NULL DEFAULT NULL AFTER level,
  ADD COLUMN IF NOT EXISTS holder BIGINT UNSIGNED AS (IFNULL(user_id * 2, group_id * 2 + 1)) STORED,
  ADD COLUMN IF NOT EXISTS scope BIGINT UNSIGNED AS (COALESCE(robot_id * 2, site_id * 2 + 1, 0)) STORED,
  DROP PRIMARY KEY,
  ADD PRIMARY KEY (id),
  ADD UNIQUE KEY IF NOT EXISTS grants_pair (holder, scope),
  ADD KEY IF NOT EXISTS grants_user (user_id),
  ADD KEY IF NOT EXISTS grants_robot (robot_id),
  ADD CONSTRAINT grants_group FOREIGN KEY IF NOT EXISTS grants_group (group_id) REFERENCES user_groups (id) ON DELETE CASCADE,
  ADD CONSTRAINT grants_site FOREIGN KEY IF NOT EXISTS grants_site (site_id) REFERENCES sites (id) ON DELETE CASCADE,
  ADD CONSTRAINT IF NOT EXISTS grants_holder CHECK ((user_id IS NULL) <> (group_id IS NULL)),
  ADD CONSTRAINT IF NOT EXISTS grants_scope CHECK ((robot_id IS NOT NULL) + (site_id IS NOT NULL) + all_robots = 1);

GRANT SELECT, INSERT, UPDATE, DELETE ON sites TO 'web'@'%';
GRANT SELECT, INSERT, UPDATE, DELETE ON user_groups TO 'web'@'%';
GRANT SELECT, INSERT, UPDATE, DELETE ON user_group_members TO 'web'@'%';
