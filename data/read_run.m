% A run of labrig in MATLAB or Octave: where the axes went, and what was measured.
%
%   labrig export data/runs/NAME --format matlab --out NAME-tables
%
% then, in MATLAB, with run.mat in the present folder:
%
%   read_run
%
% run.mat holds a struct a table: run, notes, states, events, trials, frames, truth (simulated rigs), result; of a sweep
% measurements, specimens and origins; of an insertion insertions, insertion_steps (tip and estimate at each picture),
% insertion_plans, insertion_plan_path, insertion_commands and insertion_obstacles. Each field is a column; its unit
% stands in its name. Text is a cell array, an unknown number NaN.

tables = load('run.mat');
fprintf('%s: %s, %s\n', tables.run.run, tables.run.experiment, tables.run.exit_status);
if ~isempty(tables.run.verdict)
    fprintf('the operator says: %s\n', tables.run.verdict);
end

% Where the axes went, over rig time.
states = tables.states;
if isfield(states, 'insertion_mm')
    figure;
    plot(states.t_s, states.insertion_mm, states.t_s, states.linear_mm);
    xlabel('rig time [s]');
    ylabel('position [mm]');
    legend('needle', 'sheath');
end

if isfield(tables, 'measurements')
    % The radius of each insertion that could be measured, with its 95 % interval.
    measured = tables.measurements;
    final = strcmp(measured.role, 'final') & measured.accepted == 1;
    radius_mm = measured.radius_mm(final);
    gelatin_percent = measured.gelatin_percent(final);
    figure;
    errorbar(measured.trial(final), radius_mm, radius_mm - measured.radius_ci95_low_mm(final), ...
        measured.radius_ci95_high_mm(final) - radius_mm, 'o');
    xlabel('trial');
    ylabel('radius [mm]');

    % The mean of each gel, computed again from the radii; specimens holds what labrig computed.
    gels = unique(gelatin_percent);
    for i = 1:numel(gels)
        of_gel = radius_mm(gelatin_percent == gels(i));
        fprintf('%g %%: mean radius %.3f mm, SD %.3f mm, n = %d\n', gels(i), mean(of_gel), std(of_gel), numel(of_gel));
    end
end

if isfield(tables, 'insertion_steps')
    % The way to the target as it was seen and estimated, insertion by insertion; z along the insertion, y lateral.
    steps = tables.insertion_steps;
    trials = unique(steps.trial);
    for i = 1:numel(trials)
        here = steps.trial == trials(i);
        end_of = tables.insertions.trial == trials(i);
        figure;
        plot(steps.tip_z_mm(here), steps.tip_y_mm(here), 'x', steps.estimate_z_mm(here), steps.estimate_y_mm(here), '-', ...
            tables.insertions.target_z_mm(end_of), tables.insertions.target_y_mm(end_of), 'o');
        axis equal;
        xlabel('z [mm]');
        ylabel('y [mm]');
        legend('tip seen', 'tip estimated', 'target');
        fprintf('insertion %d: %s, %.3f mm from the target, %d pictures\n', trials(i), ...
            tables.insertions.outcome{end_of}, tables.insertions.target_error_mm(end_of), sum(here));
    end
end
