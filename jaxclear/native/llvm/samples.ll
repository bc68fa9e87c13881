
define void @{name}.samples(ptr %data, ptr %out, i64 %samples) {{
entry:
  %in = alloca [{inputs} x double], align 64
  %given = alloca [{outputs} x double], align 64
  %big = alloca [{places} x ptr], align 64
  %last = sub i64 %samples, 1
  %packed = load ptr, ptr %data
  br label %group
group:
  %start = phi i64 [ 0, %entry ], [ %next, %stored ]
  %going = icmp slt i64 %start, %samples
  br i1 %going, label %lane, label %done
lane:
  %l = phi i64 [ 0, %group ], [ %l_next, %lane_end ]
  %place = add i64 %start, %l
  %beyond = icmp sgt i64 %place, %last
  %sample = select i1 %beyond, i64 %last, i64 %place
  %row = mul i64 %sample, {width}
  br label %entry_loop
entry_loop:
  %j = phi i64 [ 0, %lane ], [ %j_next, %entry_body ]
  %more = icmp slt i64 %j, {width}
  br i1 %more, label %entry_body, label %pointers
entry_body:
  %from_index = add i64 %row, %j
  %from = getelementptr double, ptr %packed, i64 %from_index
  %value = load double, ptr %from
  %to_row = mul i64 %j, {lanes}
  %to_index = add i64 %to_row, %l
  %to = getelementptr double, ptr %in, i64 %to_index
  store double %value, ptr %to
  %j_next = add i64 %j, 1
  br label %entry_loop
pointers:
{pointers}
  br label %lane_end
lane_end:
  %l_next = add i64 %l, 1
  %all = icmp sge i64 %l_next, {lanes}
  br i1 %all, label %run, label %lane
run:
  call void @{name}.loop(ptr %in, ptr %given, ptr %big)
  br label %store_lane
store_lane:
  %s = phi i64 [ 0, %run ], [ %s_next, %store_end ]
  %goal = add i64 %start, %s
  %inside = icmp slt i64 %goal, %samples
  br i1 %inside, label %store_row, label %stored
store_row:
  %k = phi i64 [ 0, %store_lane ], [ %k_next, %store_row ]
  %give_row = mul i64 %k, {lanes}
  %give_index = add i64 %give_row, %s
  %give = getelementptr double, ptr %given, i64 %give_index
  %gift = load double, ptr %give
  %goal_row = mul i64 %goal, {height}
  %goal_index = add i64 %goal_row, %k
  %goal_place = getelementptr double, ptr %out, i64 %goal_index
  store double %gift, ptr %goal_place
  %k_next = add i64 %k, 1
  %row_done = icmp sge i64 %k_next, {height}
  br i1 %row_done, label %store_end, label %store_row
store_end:
  %s_next = add i64 %s, 1
  %lanes_done = icmp sge i64 %s_next, {lanes}
  br i1 %lanes_done, label %stored, label %store_lane
stored:
  %next = add i64 %start, {lanes}
  br label %group
done:
  ret void
}}
