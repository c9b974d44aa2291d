//! FGS-SLAM.
