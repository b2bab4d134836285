# All images in one build: `docker buildx bake`, called by tools/build.
variable "CA_BUNDLE" {
  # The CA bundle that pip and npm need on networks with an inspecting proxy; a secret, never a layer.
  default = ""
}
variable "REGISTRY" {
  # Where images are pushed to, with a slash at the end.
  default = ""
}
variable "TAG" {
  # The project's version.
  default = "0.1.0"
}
variable "ROBOT_SUITE" {
  # The Debian release of the hosts that the playbooks' tests enrol.
  default = "bookworm"
}

group "default" {
  targets = ["mysql", "sshd", "nginx", "acme", "server"]
}
group "demo" {
  targets = ["default", "sim_robot"]
}

target "mysql" {
  context = "images/mysql"
  tags    = ["${REGISTRY}robotether/mysql:${TAG}"]
}
target "sshd" {
  context = "images/sshd"
  tags    = ["${REGISTRY}robotether/sshd:${TAG}"]
}
target "nginx" {
  context = "images/nginx"
  tags    = ["${REGISTRY}robotether/nginx:${TAG}"]
}
target "acme" {
  context = "images/acme"
  tags    = ["${REGISTRY}robotether/acme:${TAG}"]
}
target "server" {
  context    = "."
  dockerfile = "images/server/Dockerfile"
  tags       = ["${REGISTRY}robotether/server:${TAG}"]
  secret     = CA_BUNDLE != "" ? ["id=ca,src=${CA_BUNDLE}"] : []
}
target "sim_robot" {
  context    = "."
  dockerfile = "images/sim_robot/Dockerfile"
  tags       = ["${REGISTRY}robotether/sim_robot:${TAG}"]
  secret     = CA_BUNDLE != "" ? ["id=ca,src=${CA_BUNDLE}"] : []
}
target "agent" {
  context    = "."
  dockerfile = "images/agent/Dockerfile"
  tags       = ["robotether/agent:${TAG}"]
  secret     = CA_BUNDLE != "" ? ["id=ca,src=${CA_BUNDLE}"] : []
}
# The computer of a robot, for the tests of playbooks and installer.
target "robot_host" {
  context    = "."
  dockerfile = "images/robot_host/Dockerfile"
  args       = { SUITE = ROBOT_SUITE }
  tags       = ["robotether/robot_host:${ROBOT_SUITE}"]
  secret     = CA_BUNDLE != "" ? ["id=ca,src=${CA_BUNDLE}"] : []
}
# An ACME authority, for the tests.
target "pebble" {
  context = "images/pebble"
  tags    = ["robotether/pebble:${TAG}"]
}
target "frontend_test" {
  inherits = ["server"]
  target   = "bundle"
  tags     = ["robotether/frontend_test:${TAG}"]
}
