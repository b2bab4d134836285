-- Which API token made a join token or added a person's SSH key: what a program made goes with its token.
ALTER TABLE join_tokens
  ADD COLUMN IF NOT EXISTS api_token_id INT UNSIGNED NULL,
  ADD CONSTRAINT join_tokens_api_token FOREIGN KEY IF NOT EXISTS join_tokens_api_token (api_token_id) REFERENCES api_tokens (id) ON DELETE SET NULL;
ALTER TABLE user_ssh_keys
  ADD COLUMN IF NOT EXISTS api_token_id INT UNSIGNED NULL,
  ADD CONSTRAINT user_ssh_keys_api_token FOREIGN KEY IF NOT EXISTS user_ssh_keys_api_token (api_token_id) REFERENCES api_tokens (id) ON DELETE SET NULL;
