// Which types of messages are too large to be asked for again and again. Pure.

import { plainType } from "../client/messages.js";

const LARGE_TYPES = new Set([
  "sensor_msgs/Image",
  "sensor_msgs/CompressedImage",
  "sensor_msgs/PointCloud",
  "sensor_msgs/PointCloud2",
  "stereo_msgs/DisparityImage",
  "theora_image_transport/Packet",
  "ffmpeg_image_transport_msgs/FFMPEGPacket",
  "nav_msgs/OccupancyGrid",
  "nav_msgs/GetMap",
  "grid_map_msgs/GridMap",
  "octomap_msgs/Octomap",
  "octomap_msgs/OctomapWithPose",
  "costmap_2d/VoxelGrid",
  "nav2_msgs/VoxelGrid",
  "nav2_msgs/Costmap",
  "visualization_msgs/MarkerArray",
  "shape_msgs/Mesh",
  "audio_common_msgs/AudioData",
]);

export const isLargeType = (type) => LARGE_TYPES.has(plainType(type || ""));
