# All images in one build: `docker buildx bake`, called by tools/build.
variable "CA_BUNDLE" {
  # The CA bundle that pip and npm need on networks with an inspecting proxy; a secret, never a layer.
  default = ""
}
variable "REGISTRY" {
  # Where images are pushed to, with a slash at the end. The default is a name that no registry can have (RFC 6761), so that
  # no tool ever gets an image of ours from a stranger's.
  default = "local.invalid/"
}
variable "VERSION" {
  # The release that these sources are or become, as the packages say it.
  default = "0.1.0"
}
variable "TAG" {
  default = VERSION
}
variable "ROBOT_SUITE" {
  # The Debian release of the hosts that the playbooks' tests enrol.
  default = "bookworm"
}
variable "REVISION" {
  # The commit and its time in RFC 3339, from tools/build: the same sources make the same labels.
  default = ""
}
variable "CREATED" {
  default = ""
}
variable "SOURCE" {
  # Where these sources are published; empty: nowhere yet.
  default = ""
}

# What a site runs.
variable "PUBLISHED" {
  default = ["mysql", "sshd", "nginx", "acme", "prometheus", "server", "sim_robot"]
}

group "default" {
  targets = ["mysql", "sshd", "nginx", "acme", "server"]
}
group "demo" {
  targets = PUBLISHED
}

# What each image says of itself, as OCI names it; what is not known is left out.
function "labels" {
  params = [name, description]
  result = {
    "org.opencontainers.image.title"       = "Robotether: ${name}"
    "org.opencontainers.image.description" = description
    "org.opencontainers.image.version"     = VERSION
    "org.opencontainers.image.revision"    = notequal(REVISION, "") ? REVISION : null
    "org.opencontainers.image.created"     = notequal(CREATED, "") ? CREATED : null
    "org.opencontainers.image.source"      = notequal(SOURCE, "") ? SOURCE : null
    "org.opencontainers.image.licenses"    = "Apache-2.0"
  }
}

target "mysql" {
  labels  = labels("mysql", "The database: MariaDB with the accounts of the stack")
  context = "images/mysql"
  tags    = ["${REGISTRY}robotether/mysql:${TAG}"]
}
target "sshd" {
  labels  = labels("sshd", "The end of robots' tunnels: OpenSSH, key look-ups, session command")
  context = "images/sshd"
  tags    = ["${REGISTRY}robotether/sshd:${TAG}"]
}
target "nginx" {
  labels  = labels("nginx", "The only way in: TLS, redirects, SSH on 443")
  context = "images/nginx"
  tags    = ["${REGISTRY}robotether/nginx:${TAG}"]
}
target "acme" {
  labels  = labels("acme", "Gets and renews the certificate from an ACME authority")
  context = "images/acme"
  tags    = ["${REGISTRY}robotether/acme:${TAG}"]
}
target "prometheus" {
  labels  = labels("prometheus", "Keeps the relay's numbers and works out alerts: Prometheus")
  context = "images/prometheus"
  tags    = ["${REGISTRY}robotether/prometheus:${TAG}"]
}
target "server" {
  labels     = labels("server", "The pages, the API, the relay and the robotether command")
  context    = "."
  dockerfile = "images/server/Dockerfile"
  tags       = ["${REGISTRY}robotether/server:${TAG}"]
  secret     = CA_BUNDLE != "" ? ["id=ca,src=${CA_BUNDLE}"] : []
}
target "sim_robot" {
  labels     = labels("sim_robot", "A simulated robot: simulator and agent")
  context    = "."
  dockerfile = "images/sim_robot/Dockerfile"
  tags       = ["${REGISTRY}robotether/sim_robot:${TAG}"]
  secret     = CA_BUNDLE != "" ? ["id=ca,src=${CA_BUNDLE}"] : []
}
# A robot with a real ROS 2 graph, for the tests.
target "ros2_robot" {
  labels     = labels("ros2_robot", "A robot with a real ROS 2 graph, for tests")
  context    = "."
  contexts   = { "local.invalid/robotether/sim_robot" = "target:sim_robot" }
  dockerfile = "images/ros2_robot/Dockerfile"
  tags       = ["${REGISTRY}robotether/ros2_robot:${TAG}"]
  secret     = CA_BUNDLE != "" ? ["id=ca,src=${CA_BUNDLE}"] : []
}
target "agent" {
  labels     = labels("agent", "The agent, for robots that run everything in containers")
  context    = "."
  dockerfile = "images/agent/Dockerfile"
  tags       = ["${REGISTRY}robotether/agent:${TAG}"]
  secret     = CA_BUNDLE != "" ? ["id=ca,src=${CA_BUNDLE}"] : []
}
# The computer of a robot, for the tests of playbooks and installer.
target "robot_host" {
  labels     = labels("robot_host", "The computer of a robot, for the tests of playbooks and installer")
  context    = "."
  dockerfile = "images/robot_host/Dockerfile"
  args       = { SUITE = ROBOT_SUITE }
  tags       = ["${REGISTRY}robotether/robot_host:${ROBOT_SUITE}"]
  secret     = CA_BUNDLE != "" ? ["id=ca,src=${CA_BUNDLE}"] : []
}
# An ACME authority, for the tests.
target "pebble" {
  labels  = labels("pebble", "An ACME authority, for tests")
  context = "images/pebble"
  tags    = ["${REGISTRY}robotether/pebble:${TAG}"]
}
# A registry, for the tests.
target "registry" {
  labels  = labels("registry", "A registry, for tests")
  context = "images/registry"
  tags    = ["${REGISTRY}robotether/registry:${TAG}"]
}
# A machine with an engine of its own, for the tests of Docker Swarm.
target "docker_host" {
  labels  = labels("docker_host", "A machine with a Docker engine of its own, for tests")
  context = "images/docker_host"
  tags    = ["${REGISTRY}robotether/docker_host:${TAG}"]
}
target "frontend_test" {
  inherits = ["server"]
  labels   = labels("frontend_test", "The browser modules with their own tests")
  target   = "bundle"
  tags     = ["${REGISTRY}robotether/frontend_test:${TAG}"]
}

# What is in each image, as CycloneDX, in build/sbom/: with any builder, and without a registry. tools/build sbom
target "sbom" {
  name     = "sbom_${image}"
  matrix   = { image = concat(PUBLISHED, ["agent"]) }
  context  = "images/sbom"
  contexts = { scanned = "target:${image}" }
  args     = { IMAGE = image, VERSION = VERSION }
  output   = ["type=local,dest=build/sbom"]
  secret   = CA_BUNDLE != "" ? ["id=ca,src=${CA_BUNDLE}"] : []
}
# Pushes each image with SLSA provenance and BuildKit's own SBOM attached: REGISTRY=HOST/ tools/build release. The engine's
# own builder makes no attestations unless it has the containerd image store; one of the driver docker-container does.
# BuildKit runs SBOM_SCANNER for the SBOM.
variable "SBOM_SCANNER" {
  default = "docker/buildkit-syft-scanner:stable-1"
}
target "release" {
  name     = "release_${image}"
  matrix   = { image = PUBLISHED }
  inherits = [image]
  attest   = ["type=provenance,mode=max", "type=sbom,generator=${SBOM_SCANNER}"]
  output   = ["type=registry"]
}
