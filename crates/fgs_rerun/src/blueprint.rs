//! How the viewer lays a run out.

use re_sdk::blueprint::{
    Blueprint, ContainerLike, Grid, Horizontal, Spatial2DView, Spatial3DView, Tabs, TextLogView,
    TimePanel, TimeSeriesView, Vertical,
};

use crate::recorder::{FRAME, PICTURES, PLOTS, input_path, picture_path};

/// The map beside pictures and plots.
pub fn blueprint() -> Blueprint {
    let map = Spatial3DView::new("map").with_origin("world");
    let input = Spatial2DView::new("input").with_origin(input_path());
    let pictures = PICTURES.map(|picture| {
        let view = Spatial2DView::new(picture.name);
        ContainerLike::from(view.with_origin(picture_path(picture)))
    });
    let pictures = std::iter::once(ContainerLike::from(input)).chain(pictures);
    let plots = PLOTS.map(|plot| {
        let view = TimeSeriesView::new(plot.replace('_', " "));
        ContainerLike::from(view.with_origin(format!("plots/{plot}")))
    });
    let log = TextLogView::new("log").with_origin("log");
    let plots = Grid::new(plots).with_grid_columns(2);
    let below = Tabs::new([plots.into(), ContainerLike::from(log)]);
    let pictures = Grid::new(pictures).with_grid_columns(2);
    let beside = Vertical::new([pictures.into(), below.into()]).with_row_shares([3.0, 2.0]);
    let all = Horizontal::new([map.into(), beside.into()]).with_column_shares([3.0, 2.0]);
    Blueprint::new(all).with_time_panel(TimePanel::new().with_timeline(FRAME))
}
