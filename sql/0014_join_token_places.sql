-- Where a robot that a join token admits belongs: its site, and the group of users that may drive it.
ALTER TABLE join_tokens
  ADD COLUMN IF NOT EXISTS site_id INT UNSIGNED NULL,
  ADD COLUMN IF NOT EXISTS group_id INT UNSIGNED NULL,
  ADD CONSTRAINT join_tokens_site FOREIGN KEY IF NOT EXISTS join_tokens_site (site_id) REFERENCES sites (id) ON DELETE SET NULL,
  ADD CONSTRAINT join_tokens_group FOREIGN KEY IF NOT EXISTS join_tokens_group (group_id) REFERENCES user_groups (id) ON DELETE SET NULL;
