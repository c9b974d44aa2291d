export {
  BufferGeometry, Color, Float32BufferAttribute, Group, Line, LineBasicMaterial, LineSegments, Matrix4, PerspectiveCamera, Quaternion,
  Scene, Vector3, WebGLRenderer,
} from "three";
export { OrbitControls } from "three/addons/controls/OrbitControls.js";
export { ExtSplats, SparkRenderer, SplatMesh } from "@sparkjsdev/spark";
